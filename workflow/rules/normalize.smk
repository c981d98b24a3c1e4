rule normalize:
    """The factors by which the images of a level add up to the floodlit image."""
    input:
        "results/{scene}/{method}/L{level}/merge.json",
        prior,
    output:
        "results/{scene}/{method}/L{level}/normalize.json",
    log:
        "results/{scene}/{method}/L{level}/normalize.log",
    benchmark:
        "results/{scene}/{method}/L{level}/normalize.benchmark.tsv"
    priority: rays
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **WITHIN,
    params:
        plan=plan,
        settings=settings_of("normalize"),
    script:
        "../scripts/stage.py"
