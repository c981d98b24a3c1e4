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
        **asked("acquire", of_level=True),
        **WITHIN,
    params:
        plan=plan,
        stages=stages,
        scene=scene_settings,
        camera=camera,
        rig=simulated_rig,
        until="refine",
    script:
        "../scripts/acquire_simulated.py"
