rule assemble:
    """A scene's transport, from what all levels added."""
    input:
        refined,
    output:
        "results/{scene}/{method}/transport.json",
    log:
        "results/{scene}/{method}/assemble.log",
    benchmark:
        "results/{scene}/{method}/assemble.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **WITHIN,
    params:
        plan=plan,
        settings=settings_of("assemble"),
    script:
        "../scripts/stage.py"
