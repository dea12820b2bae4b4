"""What was made from what: keys of code, configuration and inputs; what is kept, what is made again, and why."""
