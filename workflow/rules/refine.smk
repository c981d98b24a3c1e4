rule refine:
    """What a level's images tell about the transport, and what is left to ask."""
    input:
        schedule=LEVEL + "schedule.json",
        merged=LEVEL + "merge.json",
        normalized=LEVEL + "normalize.json",
        known=refined_above,
    output:
        LEVEL + "refine.json",
    params:
        plan=plan,
        code=stage_code("refine"),
    log:
        LEVEL + "refine.log",
    benchmark:
        LEVEL + "refine.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    script:
        "../scripts/refine.py"
