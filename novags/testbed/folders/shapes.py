"""What records of finished stages look like, as far as later stages rely on it; see `sensor_model.files.records`."""

from typing import Any

from novags.testbed.folders.place import PLACE
from sensor_model.files.records import Numbers

MEASURED: Any = (float, str, None)  # "inf" and "nan" are text in JSON; null: not measured
EFFECT = {"name": str, "on": bool, "forced": bool, "contribution": MEASURED, "bound": MEASURED, "unit": str,
          "reason": str}  # fmt: skip
PLAN = {"effects": [EFFECT], "bound": MEASURED, "unit": str, "biases?": {"*": MEASURED}}
HARDWARE = {"processor": str, "cores": int, "memory_bytes": int, "gpu": (str, None)}
STAGE = {"key": str, "code?": str, "inputs": {"*": str}, "config": dict, "seconds": float, "peak_bytes": int,
         "files?": {"*": str}}  # fmt: skip
CAPTURE = {
    "set": {"path": PLACE, "kind": str, "max_size": (int, None)}, "sensor_name": str, "sensor": dict,
    "exposure": {"time": float, "temperature?": (float, None), "origin": [int], "line_time?": float},
    "electrons": float, "signal_quantiles_e": {"0.01": float, "0.99": float}, "demosaic": str,
    "burst?": int, "uneven?": {"exposures": [float], "balances": [Numbers(3)]},
    "seed?": int, "noise_seed?": int, "mean_green_radiance?": float,
    "color_matrix": (Numbers(3, 3), None), "jpeg_quality?": (int, None), "views": int, "width": int, "height": int,
    "maps?": str, "dark_frames?": str, "plan": (PLAN, None), "stage": {**STAGE, "inputs": {"set": str}},
}  # fmt: skip
IMPORT = {  # a capture.json of kind "imported"
    "kind": str, "scene": str, "files": {"*": str}, "depth": str, "parts": [str], "jpeg": bool,
    "raw": ({"cfa": (str, None), "black": float, "white": float}, None), "sensor_name": (str, None),
    "sensor": (dict, None), "exposure": {"time": float, "temperature?": (float, None), "origin": [int],
    "line_time?": float}, "demosaic": str, "color_matrix": (Numbers(3, 3), None), "resampled": (str, None),
    "lit": ({"folder": str, "paired": str, "resampled?": int}, None), "dataset?": (str, None), "split?": str,
    "lit_alone?": [str], "unlit?": [str], "unscanned?": [str],
    "clean": ({"folder": str, "paired": str, "gain": float, "white_share": float}, None),
    "views": int, "width": int, "height": int, "stage": {**STAGE, "inputs": {"*": str}},
}  # fmt: skip
CAMERAS = {"source": str, "unregistered": [str], "registered_share": float, "mean_rotation_deg": float,
           "mean_centre_error": float, "depth_scale": float}  # fmt: skip
VIEWER_CAMERAS = [{"img_name": str, "position": Numbers(3), "rotation": Numbers(3, 3)}]
RUN = {
    "name": str, "method": str, "title?": str, "capture": PLACE, "effects?": [str], "space": str, "config": dict,
    "enhancement": ({"enhancer": str, "pictures": str, "config": dict}, None), "cameras?": (CAMERAS, None),
    "seconds": {"*": float}, "along?": [int], "held_out?": [str], "fits?": [dict],
    "stage": {**STAGE, "inputs": {"capture": str, "set": str}, "versions": {"*": str}, "hardware": HARDWARE},
}  # fmt: skip
EXPERIMENT = {"command": (str, None), "preset": dict}
GEOMETRY = {"abs_rel": MEASURED, "within_5_percent": MEASURED, "coverage": MEASURED, "floaters": MEASURED,
            "consistency": {"excess": MEASURED}, "f1?": MEASURED, "accuracy?": MEASURED,
            "completeness?": MEASURED}  # fmt: skip
BLUR = {"psnr": MEASURED, "aligned_psnr": MEASURED, "sigma": float}
SCORES = {
    "mean": {"*": ({"*": MEASURED}, None)}, "views": {"*": {"*": {"*": MEASURED}}}, "geometry?": (GEOMETRY, None),
    "noise?": ({"known": MEASURED, "targets": MEASURED, "renders": MEASURED, "bias_floor": MEASURED}, None),
    "training_2d": ({"enhanced": dict, "blur": BLUR, "best_blur?": BLUR}, None), "seconds": {"*": float},
    "peak_bytes": int,
    "frames_per_second?": ({"160": float, "800": float, "device": str, "threads": int}, None),
    "along?": [{"iterations": int, "mean": {"*": ({"*": MEASURED}, None)}}],
    "held_out?": {"psnr": {"*": float}, "stop": int},
}  # fmt: skip
METRICS = {"methods": {"*": SCORES}, "unavailable": {"*": str}}
