"""Hard cases of the splat engine, and the float64 rasteriser that is their reference."""
