rule acquire:
    """A scene's transport, all levels and stages of it in one job.

    For collections and clusters. One acquisition at a time has a real rig; what it does between
    two levels' captures takes a twentieth of their time (docs/performance.md).
    """
    output:
        "results/{scene}/{method}/transport.json",
    log:
        "results/{scene}/{method}/acquire.log",
    benchmark:
        "results/{scene}/{method}/acquire.benchmark.tsv"
    localrule: CAPTURED_HERE
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        **{**WITHIN, "runtime": minutes(240)},
        **AT_THE_RIG,
    params:
        plan=plan,
        settings=settings_of(),
        rig=rig,
    script:
        "../scripts/acquire.py"
