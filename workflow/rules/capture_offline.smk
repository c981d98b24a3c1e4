rule capture_offline:
    """The brackets of a level whose pictures were taken elsewhere and imported.

    `rfpipe patterns` and `rfpipe import` take an acquisition from level to level; where pictures
    are missing, this rule says which.
    """
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
    resources:
        **WITHIN,
    params:
        by="pictures",
        rig=lambda wildcards: rig(wildcards.scene)["rig"],
        settings=settings_of("capture"),
    script:
        "../scripts/stage.py"
