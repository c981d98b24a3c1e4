rule drop_raw:
    """Remove raw exposures that are merged, if capture.keep_raw became false.

    If it was false from the start of the run, merges remove them.
    """
    input:
        "results/{scene}/{method}/transport.json",
    output:
        touch("results/{scene}/{method}/raw_dropped"),
    log:
        "results/{scene}/{method}/drop_raw.log",
    localrule: True
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **WITHIN,
    script:
        "../scripts/drop_raw.py"
