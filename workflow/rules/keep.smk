rule keep:
    """Transports, relit pictures and report in a bucket, where others read them.

    Last of all, and on this machine: a run that can't reach the bucket has its results, and the
    next run sends what is missing. What was captured stays here.
    """
    input:
        every_acquisition("transport.json"),
        every_acquisition("relight.json"),
        "results/report/index.html",
        every_view,
    output:
        "results/kept.json",
    log:
        "results/kept.log",
    localrule: True
    conda:
        "../envs/rfpipe.yaml"
    params:
        address=SETTINGS.storage.keep_at or "",
    script:
        "../scripts/keep.py"
