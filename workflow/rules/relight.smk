rule relight:
    """The transport under the reference patterns, beside what is true of the scene."""
    input:
        "results/{scene}/{method}/transport.json",
    output:
        "results/{scene}/{method}/relight.json",
    log:
        "results/{scene}/{method}/relight.log",
    benchmark:
        "results/{scene}/{method}/relight.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **asked("relight"),
    params:
        scene=scene_settings,
        code=relight_code,
    script:
        "../scripts/relight.py"


rule sweep:
    """Speed against error: the same acquisition at other tolerances, in one process."""
    output:
        "results/{scene}/{method}/sweep.json",
    log:
        "results/{scene}/{method}/sweep.log",
    benchmark:
        "results/{scene}/{method}/sweep.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **asked("sweep"),
    params:
        settings=sweep_settings,
        code=sweep_code,
    script:
        "../scripts/sweep.py"
