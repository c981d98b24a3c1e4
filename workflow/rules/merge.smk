rule merge:
    """Radiance images with their variance; level 0 calibrates the merge of every level."""
    input:
        captured="results/{scene}/{method}/L{level}/capture.json",
        calibration=calibration,
    output:
        "results/{scene}/{method}/L{level}/merge.json",
    log:
        "results/{scene}/{method}/L{level}/merge.log",
    benchmark:
        "results/{scene}/{method}/L{level}/merge.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    threads: threads
    resources:
        mem_mib=MEMORY_MIB,
        cluster=SETTINGS.resources.cluster or "",
    params:
        merge=plain(SETTINGS.merge),
        keep_raw=SETTINGS.capture.keep_raw,
        code=stage_code("merge"),
    script:
        "../scripts/merge.py"
