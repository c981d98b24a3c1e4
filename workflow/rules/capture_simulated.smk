rule capture_simulated:
    """The brackets of a level's patterns, taken of a simulated scene.

    Simulated captures may run side by side; each goes on at the pattern where it stopped.
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
    threads: threads
    resources:
        mem_mib=MEMORY_MIB,
    params:
        scene=scene_settings,
        camera=SETTINGS.camera and plain(SETTINGS.camera),
        seed=SETTINGS.seed,
        seconds_per_pattern=SETTINGS.capture.seconds_per_pattern,
        references=references,
        expected_patterns=expected,
        capture=CAPTURE,
    script:
        "../scripts/capture_simulated.py"
