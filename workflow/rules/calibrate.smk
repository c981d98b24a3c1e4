# `snakemake calibrate`: the rig of the setting rig_file, one job a step; no part of a run.

if SETTINGS.rig_file is not None:

    from rfpipe.calibration import steps_of
    from rfpipe.config import load_rig_config

    RIG = load_rig_config(SETTINGS.rig_file)
    CALIBRATION = RIG.calibration or "calibration"
    CALIBRATION_STEPS = {step.name: step for step in steps_of(RIG.calibrate)}

    def calibration_needs(wildcards):
        """Manifests of the steps that a step builds on."""
        needs = CALIBRATION_STEPS[wildcards.step].needs
        return [f"{CALIBRATION}/steps/{name}.json" for name in needs]

    def calibration_settings(wildcards):
        """The rig's settings, with those of the calibration that shape this step alone."""
        step = CALIBRATION_STEPS[wildcards.step]
        shaping = RIG.calibrate.model_dump(
            mode="json", include={"coaxial", *step.settings}
        )
        rig = RIG.model_dump(
            mode="json", exclude={"calibrate", "calibration", "seconds_per_pattern"}
        )
        return {**rig, "calibrate": shaping}

    rule calibration_step:
        """What one step of the calibration shows, takes and finds."""
        input:
            calibration_needs,
        output:
            f"{CALIBRATION}/steps/{{step}}.json",
        log:
            f"{CALIBRATION}/steps/{{step}}.log",
        wildcard_constraints:
            step="|".join(CALIBRATION_STEPS),
        conda:
            "../envs/rfpipe.yaml"
        resources:
            rig=1,
        params:
            rig=calibration_settings,
        script:
            "../scripts/calibration_step.py"

    rule calibrate:
        """The calibration that the steps make up, and its report."""
        input:
            expand(f"{CALIBRATION}/steps/{{step}}.json", step=CALIBRATION_STEPS),
        output:
            facts=f"{CALIBRATION}/calibration.json",
            page=f"{CALIBRATION}/report.html",
        log:
            f"{CALIBRATION}/calibrate.log",
        conda:
            "../envs/rfpipe.yaml"
        params:
            settings=RIG.calibrate.model_dump(mode="json"),
            code=code_digest(pages=True),
        script:
            "../scripts/calibrate.py"
