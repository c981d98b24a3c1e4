rule schedule:
    """The patterns of a level, from what the levels above it found."""
    input:
        refined_above,
    output:
        LEVEL + "schedule.json",
    params:
        plan=plan,
        code=stage_code("schedule"),
    log:
        LEVEL + "schedule.log",
    benchmark:
        LEVEL + "schedule.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    script:
        "../scripts/schedule.py"
