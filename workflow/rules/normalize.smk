rule normalize:
    """The factors that make a level's images add up to the floodlit image [B.2]."""
    input:
        schedule=LEVEL + "schedule.json",
        merged=LEVEL + "merge.json",
        calibration=calibration,
        known=refined_above,
    output:
        LEVEL + "normalize.json",
    params:
        plan=plan,
        mode=SETTINGS.normalization,
        code=stage_code("normalize"),
    log:
        LEVEL + "normalize.log",
    benchmark:
        LEVEL + "normalize.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    script:
        "../scripts/normalize.py"
