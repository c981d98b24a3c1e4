rule acquire_simulated:
    """A scene's transport, from patterns shown to a simulated rig, level by level."""
    input:
        levels_before,
    output:
        "results/{scene}/{method}/transport.json",
    log:
        "results/{scene}/{method}/acquire.log",
    benchmark:
        "results/{scene}/{method}/acquire.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **asked("acquire"),
        **WITHIN,
    params:
        plan=plan,
        stages=stages,
        scene=scene_settings,
        camera=camera,
        rig=simulated_rig,
    script:
        "../scripts/acquire_simulated.py"


rule verify_simulated:
    """A simulated scene's transport beside pictures that no method saw."""
    input:
        "results/{scene}/{method}/transport.json",
    output:
        "results/{scene}/{method}/verification.json",
    log:
        "results/{scene}/{method}/verification.log",
    benchmark:
        "results/{scene}/{method}/verification.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **asked("verification"),
        **WITHIN,
    params:
        plan=plan,
        stages=verification,
        scene=scene_settings,
        camera=camera,
        rig=simulated_rig,
    script:
        "../scripts/verify_simulated.py"
