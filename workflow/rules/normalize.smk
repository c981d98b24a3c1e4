rule normalize:
    """The factors that make a level's images add up to the floodlit image [B.2]."""
    input:
        schedule="results/{scene}/{method}/L{level}/schedule.json",
        merged="results/{scene}/{method}/L{level}/merge.json",
        calibration=calibration,
        known=refined_above,
    output:
        "results/{scene}/{method}/L{level}/normalize.json",
    log:
        "results/{scene}/{method}/L{level}/normalize.log",
    benchmark:
        "results/{scene}/{method}/L{level}/normalize.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    params:
        plan=plan,
        mode=SETTINGS.normalization,
        code=stage_code("normalize"),
    script:
        "../scripts/normalize.py"
