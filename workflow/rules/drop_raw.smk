rule drop_raw:
    """Free the disk of raw exposures that are merged, where capture.keep_raw became false.

    Captures of a run that has had this setting from its beginning are freed by their merges.
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
