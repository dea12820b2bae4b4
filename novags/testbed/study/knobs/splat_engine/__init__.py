"""One setting of the splat engine, measured in a process of its own: kernels take constants when they are compiled."""
