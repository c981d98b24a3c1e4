rule capture_hardware:
    """The brackets of a level, by the rig behind an acquisition server, one level at a time."""
    input:
        scheduled,
    output:
        "results/{scene}/{method}/L{level}/capture.json",
    log:
        "results/{scene}/{method}/L{level}/capture.log",
    benchmark:
        "results/{scene}/{method}/L{level}/capture.benchmark.tsv"
    localrule: CAPTURED_HERE
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **WITHIN,
        **AT_THE_RIG,
    params:
        by="server",
        rig=lambda wildcards: rig(wildcards.scene)["rig"],
        settings=settings_of("capture"),
    script:
        "../scripts/stage.py"
