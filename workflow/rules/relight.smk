rule relight:
    """The transport under the reference patterns, and the true pictures of the scene."""
    input:
        "results/{scene}/{method}/transport.json",
    output:
        "results/{scene}/{method}/relight.json",
    log:
        "results/{scene}/{method}/relight.log",
    benchmark:
        "results/{scene}/{method}/relight.benchmark.tsv"
    priority: rays
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **ASKED,
    params:
        scene=scene_settings,
        code=lambda wildcards: stage_code(SETTINGS, wildcards.scene),
    script:
        "../scripts/relight.py"
