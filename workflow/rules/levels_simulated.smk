checkpoint level:
    """One level of a scene's acquisition, before a simulated rig.

    What it leaves tells whether there is another one.
    """
    input:
        previous_level,
    output:
        "results/{scene}/{method}/L{level}/refine.json",
    log:
        "results/{scene}/{method}/level_{level}.log",
    benchmark:
        "results/{scene}/{method}/level_{level}.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        mem_mb=memory("acquire"),
        runtime=runtime("acquire"),
        disk_mb=disk,
        memory_gib=str(SETTINGS.resources.memory_gib),
        workers=SETTINGS.resources.workers,
    params:
        plan=plan,
        stages=stages,
        scene=scene_settings,
        camera=camera,
        rig=simulated_rig,
        until="refine",
    script:
        "../scripts/acquire_simulated.py"
