rule capture_hardware:
    """The brackets of a level's patterns, taken by the rig behind an acquisition server.

    One capture at a time uses the rig; each goes on at the pattern where it stopped.
    """
    input:
        "results/{scene}/{method}/L{level}/schedule.json",
    output:
        "results/{scene}/{method}/L{level}/capture.json",
    log:
        "results/{scene}/{method}/L{level}/capture.log",
    benchmark:
        "results/{scene}/{method}/L{level}/capture.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    resources:
        rig=1,
        mem_mib=MEMORY_MIB,
        # where the rig is, and how long to wait for it, shapes no result
        rig_url=SETTINGS.capture.url,
        rig_token_file=SETTINGS.capture.token_file or "",
        rig_patience=str(SETTINGS.capture.patience_seconds),
    params:
        plan=plan,
        references=references,
        expected_patterns=expected,
        capture=CAPTURE,
    script:
        "../scripts/capture_hardware.py"
