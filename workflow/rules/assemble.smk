rule assemble:
    """The transport, from what all levels added."""
    input:
        refined,
    output:
        "results/{scene}/{method}/transport.json",
    log:
        "results/{scene}/{method}/transport.log",
    benchmark:
        "results/{scene}/{method}/transport.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    params:
        plan=plan,
        number_format=SETTINGS.storage.number_format,
        code=stage_code("assemble"),
    script:
        "../scripts/assemble.py"
