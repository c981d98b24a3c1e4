rule capture_simulated:
    """The brackets of a level, by a simulated rig."""
    input:
        scheduled,
    output:
        "results/{scene}/{method}/L{level}/capture.json",
    log:
        "results/{scene}/{method}/L{level}/capture.log",
    benchmark:
        "results/{scene}/{method}/L{level}/capture.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **WITHIN,
    params:
        by="simulation",
        rig=lambda wildcards: rig(wildcards.scene)["rig"],
        settings=settings_of("capture"),
    script:
        "../scripts/stage.py"
