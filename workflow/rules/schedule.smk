rule schedule:
    """The patterns of a level, from what the levels above it found."""
    input:
        refined_above,
    output:
        "results/{scene}/{method}/L{level}/schedule.json",
    log:
        "results/{scene}/{method}/L{level}/schedule.log",
    benchmark:
        "results/{scene}/{method}/L{level}/schedule.benchmark.tsv"
    conda:
        "../envs/rfpipe.yaml"
    params:
        plan=plan,
        code=stage_code("schedule"),
    script:
        "../scripts/schedule.py"
