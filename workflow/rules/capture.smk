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
    priority: rays
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **WITHIN,
    params:
        rig=rig,
        settings=settings_of("capture"),
    script:
        "../scripts/stage.py"


if SETTINGS.capture.rule == "hardware":

    use rule capture_simulated as capture_hardware with:
        # The brackets of a level, by the rig behind an acquisition server, one level at a time.
        localrule: CAPTURED_HERE
        threads: 1
        resources:
            **WITHIN,
            **AT_THE_RIG,

    ruleorder: capture_hardware > capture_simulated


if SETTINGS.capture.rule == "offline":

    use rule capture_simulated as capture_offline with:
        # The brackets of a level whose pictures were taken elsewhere and imported. `rfpipe
        # patterns` and `rfpipe import` take an acquisition from level to level; where pictures
        # are missing, this rule names them.
        threads: 1

    ruleorder: capture_offline > capture_simulated
