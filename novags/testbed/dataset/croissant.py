"""Croissant 1.0 metadata (mlcommons.org/croissant/1.0): the files, and the views as records read from index.csv."""

from collections.abc import Sequence
from typing import Any

from novags.testbed.dataset.file import DatasetConfig
from novags.testbed.dataset.publish import INDEX

CONTEXT: dict[str, Any] = {
    "@language": "en", "@vocab": "https://schema.org/", "citeAs": "cr:citeAs", "column": "cr:column",
    "conformsTo": "dct:conformsTo", "cr": "http://mlcommons.org/croissant/", "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"}, "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/", "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"}, "extract": "cr:extract",
    "field": "cr:field", "fileProperty": "cr:fileProperty", "fileObject": "cr:fileObject", "fileSet": "cr:fileSet",
    "format": "cr:format", "includes": "cr:includes", "isLiveDataset": "cr:isLiveDataset", "jsonPath": "cr:jsonPath",
    "key": "cr:key", "md5": "cr:md5", "parentField": "cr:parentField", "path": "cr:path", "recordSet": "cr:recordSet",
    "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated", "replace": "cr:replace",
    "samplingRate": "cr:samplingRate", "sc": "https://schema.org/", "separator": "cr:separator", "source": "cr:source",
    "subField": "cr:subField", "transform": "cr:transform",
}  # fmt: skip
TYPES = {"electrons": "sc:Float", "seed": "sc:Integer", "noise_seed": "sc:Integer", "held_out": "sc:Boolean"}
MEANING = {
    "split": "train, val or test", "scene": "what was rendered", "sensor": "the camera model",
    "electrons": "mean signal of green, electrons per pixel and exposure",
    "seed": "as the file of the data set has it: of several exposures of the same light",
    "noise_seed": "of the random numbers of the noise, which no other capture has",
    "capture": "folder of the dark pictures", "set": "folder of the views in good light", "view": "name of the view",
    "held_out": "whether the view is held out for testing a reconstruction of its scene",
    "dark": "dark picture, 8-bit sRGB PNG", "dark16": "dark picture, 16-bit linear PNG", "raw": "raw frame, DNG",
    "truth": "mean, variance and noise-free digital numbers, EXR", "lit": "the view in good light, 8-bit sRGB PNG",
    "gt": "radiance, depth, normals, albedo and ids, EXR",
}  # fmt: skip


def croissant(
    config: DatasetConfig, columns: Sequence[str], files: dict[str, dict[str, Any]], shards: Sequence[str]
) -> dict[str, Any]:
    """The content of croissant.json.

    Args:
        config: Of the data set.
        columns: Of index.csv.
        files: `bytes` and `sha256` of every file, by its relative name.
        shards: Names of the shards.
    """
    cited = f"{', '.join(config.creators)}: {config.name}, version {config.version}" if config.creators else ""
    optional = {"url": config.url, "datePublished": config.date, "citeAs": cited,
                "creator": [{"@type": "sc:Person", "name": name} for name in config.creators]}  # fmt: skip
    distribution = [_file(INDEX, "text/csv", files), *(_file(name, "application/x-tar", files) for name in shards)]
    if shards:
        distribution.append({
            "@type": "cr:FileSet", "@id": "samples", "name": "samples", "description": "Pictures and cameras of views",
            "containedIn": [{"@id": name} for name in shards], "encodingFormat": "image/png", "includes": "*.dark.png",
        })  # fmt: skip
    return {
        "@context": CONTEXT, "@type": "sc:Dataset", "name": config.name,
        "description": config.description or "Views of rendered scenes, photographed in the dark by simulated cameras.",
        "conformsTo": "http://mlcommons.org/croissant/1.0", "license": config.licence, "version": config.version,
        **{name: value for name, value in optional.items() if value}, "distribution": distribution,
        "recordSet": [{
            "@type": "cr:RecordSet", "@id": "views", "name": "views", "description": "One record for each dark view",
            "field": [_field(column) for column in columns],
        }],
    }  # fmt: skip


def _file(name: str, kind: str, files: dict[str, dict[str, Any]]) -> dict[str, Any]:
    return {"@type": "cr:FileObject", "@id": name, "name": name, "contentUrl": name, "encodingFormat": kind,
            "contentSize": f"{files[name]['bytes']} B", "sha256": files[name]["sha256"]}  # fmt: skip


def _field(column: str) -> dict[str, Any]:
    source: dict[str, Any] = {"fileObject": {"@id": INDEX}, "extract": {"column": column}}
    if column == "view":  # readers take a column of 0000, 0001 for numbers and lose the zeros: the path keeps them
        source |= {"extract": {"column": "dark"}, "transform": {"regex": r"^.*/(.+)\.png$"}}
    return {
        "@type": "cr:Field", "@id": f"views/{column}", "name": column, "description": MEANING[column],
        "dataType": TYPES.get(column, "sc:Text"), "source": source,
    }  # fmt: skip
