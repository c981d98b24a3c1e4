rule acquire_offline:
    """A scene's transport, from pictures that were taken elsewhere and imported.

    `rfpipe patterns` and `rfpipe import` take an acquisition from level to level; this rule does
    what is left, or says which pictures are missing.
    """
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
        settings=SHAPING,
    script:
        "../scripts/acquire_offline.py"
