"""Physical camera model: radiance in, digital numbers out. Arrays only."""
