rule refine:
    """The state of the method after the images of a level."""
    input:
        "results/{scene}/{method}/L{level}/normalize.json",
        prior,
    output:
        "results/{scene}/{method}/L{level}/refine.json",
    log:
        "results/{scene}/{method}/L{level}/refine.log",
    benchmark:
        "results/{scene}/{method}/L{level}/refine.benchmark.tsv"
    priority: rays
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **WITHIN,
    params:
        plan=plan,
        settings=settings_of("refine"),
    script:
        "../scripts/stage.py"
