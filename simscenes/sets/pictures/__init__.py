"""Image files: EXR, PNG and whatever else photographs come in; read with limits, written atomically."""
