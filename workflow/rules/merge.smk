rule merge:
    """Radiance images with their variance, from the brackets of a level."""
    input:
        "results/{scene}/{method}/L{level}/capture.json",
    output:
        "results/{scene}/{method}/L{level}/merge.json",
    log:
        "results/{scene}/{method}/L{level}/merge.log",
    benchmark:
        "results/{scene}/{method}/L{level}/merge.benchmark.tsv"
    priority: rays
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **WITHIN,
    params:
        settings=settings_of("merge"),
    script:
        "../scripts/stage.py"
