"""What can be measured: choices that trade accuracy for time, and how a setting of each is measured."""
