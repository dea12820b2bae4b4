"""Choices to measure, which trade accuracy for time, and how a setting of each is measured."""
