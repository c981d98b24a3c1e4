rule keep:
    """Transports, relit pictures and report in a bucket.

    The last rule, on this machine: a run that can't reach the bucket keeps its results, and the next
    run uploads the missing ones. Captures aren't uploaded.
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
