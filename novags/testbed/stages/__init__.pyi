from .capturing import capture as capture
from .denoising import denoise as denoise
from .importing import import_photographs as import_photographs
from .posing import poses as poses
from .reconstructing import reconstruct as reconstruct
from .rendering import render as render
from .scores.scoring import score as score
