checkpoint schedule:
    """The patterns of a level, chosen by the state of the method; none where it is done."""
    input:
        refined_before,
        prior,
    output:
        "results/{scene}/{method}/L{level}/schedule.json",
    log:
        "results/{scene}/{method}/L{level}/schedule.log",
    benchmark:
        "results/{scene}/{method}/L{level}/schedule.benchmark.tsv"
    priority: rays
    conda:
        "../envs/rfpipe.yaml"
    resources:
        **WITHIN,
    params:
        plan=plan,
        settings=settings_of("schedule"),
    script:
        "../scripts/stage.py"
