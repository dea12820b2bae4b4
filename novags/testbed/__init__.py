"""Stages from folder to folder, experiments, scores and reports."""
