"""The configuration of each stage: one file a stage, without imports that the work itself needs."""
