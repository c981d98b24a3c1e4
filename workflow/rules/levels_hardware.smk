rule capture_level:
    """The pictures of one level, from the rig behind an acquisition server.

    The rig is free for another acquisition while they are processed, anywhere.
    """
    input:
        previous_level,
    output:
        "results/{scene}/{method}/L{level}/capture.json",
    log:
        "results/{scene}/{method}/capture_{level}.log",
    benchmark:
        "results/{scene}/{method}/capture_{level}.benchmark.tsv"
    localrule: CAPTURED_HERE
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **WHERE_THE_RIG_IS,
        **asked("acquire"),
        **WITHIN,
        rig=1,
    params:
        plan=plan,
        stages=stages,
        until="capture",
    script:
        "../scripts/acquire_hardware.py"


checkpoint level:
    """One level of a scene's acquisition, after its pictures are taken: no rig is needed.

    What it leaves tells whether there is another one.
    """
    input:
        "results/{scene}/{method}/L{level}/capture.json",
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
        **WHERE_THE_RIG_IS,
        **asked("acquire", of_level=True),
        **WITHIN,
    params:
        plan=plan,
        stages=stages,
        until="refine",
    script:
        "../scripts/acquire_hardware.py"
