rule acquire:
    """The transport of a scene, with all levels and stages in one job.

    For collections and clusters. A real rig serves one acquisition at a time; the other stages take
    a twentieth of the time of its captures (docs/performance.md).
    """
    input:
        prior,
    output:
        "results/{scene}/{method}/transport.json",
    log:
        "results/{scene}/{method}/acquire.log",
    benchmark:
        "results/{scene}/{method}/acquire.benchmark.tsv"
    priority: rays
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
