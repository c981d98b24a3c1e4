rule merge:
    """Radiance images with their variance; level 0 calibrates the merge of every level."""
    input:
        captured=LEVEL + "capture.json",
        calibration=calibration,
    output:
        LEVEL + "merge.json",
    params:
        camera=SETTINGS.camera and plain(SETTINGS.camera),
        merge=plain(SETTINGS.merge),
        code=stage_code("merge"),
    log:
        LEVEL + "merge.log",
    benchmark:
        LEVEL + "merge.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    script:
        "../scripts/merge.py"
