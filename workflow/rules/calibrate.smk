# `rfpipe run calibrate`: the rig of the setting rig_file, one job a step; no part of a run.

if SETTINGS.rig_file is not None:

    from rfpipe.calibration.steps import settings_of_step, steps_of
    from rfpipe.config import load_rig_config

    RIG = load_rig_config(SETTINGS.rig_file)
    CALIBRATION = RIG.calibration or "calibration"
    check_no_braces(f"{SETTINGS.rig_file}: calibration", CALIBRATION)
    CALIBRATION_STEPS = steps_of(RIG.calibrate)

    rule calibration_step:
        """What one step of the calibration shows, takes and finds."""
        input:
            lambda wildcards: [
                f"{CALIBRATION}/steps/{name}.json"
                for name in CALIBRATION_STEPS[wildcards.step].needs
            ],
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
            rig=lambda wildcards: settings_of_step(
                RIG, CALIBRATION_STEPS[wildcards.step]
            ),
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
