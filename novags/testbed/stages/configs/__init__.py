"""What each stage is asked for: one file a stage, without what the work itself needs."""
