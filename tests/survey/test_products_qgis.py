"""QGIS itself opens what is written for it, with the styles that come along. Needs QGIS with its Python."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from dream.survey.products import export
from tests.survey.scenes import reef

pytest.importorskip("pyproj")
pytest.importorskip("rasterio")

PYTHON = next(
    (path for path in ("/usr/bin/python3", shutil.which("python3")) if path and Path(path).exists()), ""
)
OPENING = """
import json, os, sys
from qgis.core import NULL, QgsApplication, QgsRasterLayer, QgsRenderContext, QgsSymbolLayer
from qgis.core import QgsUnitTypes, QgsVectorLayer
folder = sys.argv[1]
app = QgsApplication([], False)
app.initQgis()
told = {}
for name in ("habitat", "target_probability", "relief", "times_seen"):
    layer = QgsRasterLayer(f"{folder}/{name}.tif", name)
    kind = layer.renderer().type()
    legend = [entry.label for entry in layer.renderer().classes()] if kind == "paletted" else []
    told[name] = [layer.isValid(), layer.crs().authid(), kind, legend]
for name in ("track", "decisions", "patches", "individuals", "swath", "area", "measures"):
    layer = QgsVectorLayer(f"{folder}/survey.gpkg|layername={name}", name, "ogr")
    styled = layer.loadDefaultStyle()[1] if layer.isSpatial() else None
    told[name] = [layer.isValid(), layer.crs().authid(), layer.featureCount(), styled]
    if name == "individuals":
        looks = layer.renderer()
        context = QgsRenderContext()
        looks.startRender(context, layer.fields())
        told["sizes"] = []
        for one in layer.getFeatures():
            context.expressionContext().setFeature(one)
            symbol = looks.symbolForFeature(one, context).symbolLayer(0)
            sized = symbol.dataDefinedProperties().property(QgsSymbolLayer.PropertySize).field()
            unit = QgsUnitTypes.encodeUnit(symbol.sizeUnit())
            label = next(
                entry.label()
                for entry in looks.legendSymbolItems()
                if entry.ruleKey() in looks.legendKeysForFeature(one, context)
            )
            told["sizes"].append([one["size_m"] == NULL, label, sized, unit])
        looks.stopRender(context)
layer = QgsRasterLayer(f'NETCDF:"{folder}/survey.nc":relief', "relief")
told["netcdf"] = [layer.isValid(), layer.extent().xMinimum()]
told["geotiff"] = QgsRasterLayer(f"{folder}/relief.tif", "relief").extent().xMinimum()
print(json.dumps(told), flush=True)
# Taken down in order or not, some versions of QGIS crash at the end.
os._exit(0)
"""


def has_qgis() -> bool:
    return bool(PYTHON) and subprocess.run([PYTHON, "-c", "import qgis"], capture_output=True).returncode == 0


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    if not has_qgis():
        pytest.skip("QGIS is not installed")
    folder = tmp_path_factory.mktemp("qgis") / "out"
    export(reef(), folder, only=("geotiff", "geopackage", "netcdf"))
    ended = subprocess.run(
        [PYTHON, "-c", OPENING, str(folder)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "QT_QPA_PLATFORM": "offscreen", "PYTHONPATH": ""},
    )
    found: dict[str, Any] = json.loads(ended.stdout.splitlines()[-1])
    return found


def test_maps_open_in_their_colours(told: dict[str, Any]) -> None:
    assert told["habitat"] == [True, "EPSG:32632", "paletted", ["seen, none found", "oysters", "obstacle"]]
    for name in ("target_probability", "relief", "times_seen"):
        assert told[name] == [True, "EPSG:32632", "singlebandpseudocolor", []]


def test_the_geopackage_opens_with_its_styles(told: dict[str, Any]) -> None:
    counts = {"track": 1, "decisions": 12, "patches": 2, "individuals": 60, "swath": 1, "area": 1}
    for name, count in counts.items():
        assert told[name] == [True, "EPSG:32632", count, True]
    assert told["measures"][0]
    assert told["measures"][2] == len(reef().measures)


def test_only_measured_sizes_are_drawn_to_scale(told: dict[str, Any]) -> None:
    to_scale = [False, "individual, to scale", "size_m", "RenderMetersInMapUnits"]
    dot = [True, "individual, size not measured", "", "MM"]
    looks = told["sizes"]
    assert [one == to_scale for one in looks] == reef().individuals.clear.tolist()
    assert all(one in (to_scale, dot) for one in looks), looks


def test_the_netcdf_lies_where_the_geotiff_does(told: dict[str, Any]) -> None:
    valid, west = told["netcdf"]
    assert valid
    assert west == pytest.approx(told["geotiff"], abs=0.1)
