rule assemble:
    """The transport of a scene, computed from all levels."""
    input:
        refined,
        prior,
    output:
        "results/{scene}/{method}/transport.json",
    log:
        "results/{scene}/{method}/assemble.log",
    benchmark:
        "results/{scene}/{method}/assemble.benchmark.tsv"
    priority: rays
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **WITHIN,
    params:
        plan=plan,
        settings=settings_of("assemble"),
    script:
        "../scripts/stage.py"
