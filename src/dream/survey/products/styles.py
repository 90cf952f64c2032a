"""Colours of the maps, the same in every product, and the files from which QGIS takes them.

QGIS reads `NAME.qml` beside `NAME.tif`, and the table `layer_styles` of a GeoPackage, by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal
from xml.sax.saxutils import quoteattr

from dream.types import Target

UNKNOWN, EXPLORED, TARGET, SOLID, SOLID_TARGET = range(5)
"""Values of `Layers.state`."""

STATE_COLORS: Mapping[int, str] = {
    EXPLORED: "#e7dfc9",
    TARGET: "#1f9e62",
    SOLID: "#4b4f56",
    SOLID_TARGET: "#b4540a",
}
NOT_SEEN = "#c9d3d9"
"""Of what no frame saw, where a picture shows it at all; rasters hold no data there."""
TRACK, DECISION, INDIVIDUAL, BOX = "#0b5f86", "#f2b134", "#0a6e40", "#30414b"


def outline_color(target: Target) -> str:
    """Of a patch of reef, or of a wreck and its pieces."""
    return "#7a3806" if target is Target.WRECK else "#0d5c38"


def state_names(target: Target) -> dict[int, str]:
    """What the values of `Layers.state` are called, where something was seen."""
    if target is Target.WRECK:
        found, solid = "debris or low wreck", "hull"
    else:
        found, solid = ("oysters" if target is Target.OYSTERS else "target"), "high target"
    return {EXPLORED: "seen, none found", TARGET: found, SOLID: "obstacle", SOLID_TARGET: solid}


@dataclass(frozen=True, slots=True)
class Ramp:
    """Colours over a range of values, linear between its stops."""

    low: float
    high: float
    colors: tuple[str, ...]
    unit: str = ""

    def stops(self) -> list[tuple[float, str]]:
        """(value, colour), the lowest first."""
        step = (self.high - self.low) / (len(self.colors) - 1)
        return [(self.low + number * step, color) for number, color in enumerate(self.colors)]


PROBABILITY_COLORS = ("#f4f1e8", "#cfe3c3", "#83c79a", "#2f9e6e", "#0b5d43")
RELIEF_COLORS = ("#f3efe4", "#d9c9a0", "#c29a5b", "#9a6233", "#5c3318")
SEEN_COLORS = ("#e8f1f5", "#a9d3df", "#56a9c2", "#1f7396", "#0b3f5c")


def palette_qml(names: Mapping[int, str], colors: Mapping[int, str]) -> str:
    """A style of a raster whose values are classes: a legend with these, and no others."""
    entries = "".join(
        f'<paletteEntry value="{value}" label={quoteattr(name)} color="{colors[value]}" alpha="255"/>'
        for value, name in names.items()
    )
    return _raster_qml(
        '<rasterrenderer type="paletted" band="1" opacity="1" alphaBand="-1" nodataColor="">'
        f"<rasterTransparency/><colorPalette>{entries}</colorPalette></rasterrenderer>"
    )


def ramp_qml(ramp: Ramp) -> str:
    """A style of a raster of numbers."""
    items = "".join(
        f'<item value="{value:g}" label={quoteattr(f"{value:.3g} {ramp.unit}".strip())} color="{color}" '
        'alpha="255"/>'
        for value, color in ramp.stops()
    )
    return _raster_qml(
        f'<rasterrenderer type="singlebandpseudocolor" band="1" opacity="1" alphaBand="-1" nodataColor="" '
        f'classificationMin="{ramp.low:g}" classificationMax="{ramp.high:g}"><rasterTransparency/>'
        f'<rastershader><colorrampshader colorRampType="INTERPOLATED" classificationMode="1" clip="0" '
        f'minimumValue="{ramp.low:g}" maximumValue="{ramp.high:g}">{items}</colorrampshader></rastershader>'
        "</rasterrenderer>"
    )


def _raster_qml(renderer: str) -> str:
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
        '<qgis version="3.22.0" styleCategories="Symbology"><pipe>'
        f'{renderer}<brightnesscontrast brightness="0" contrast="0" gamma="1"/>'
        '<huesaturation saturation="0" grayscaleMode="0"/>'
        '<rasterresampler maxOversampling="2"/></pipe><blendMode>0</blendMode></qgis>\n'
    )


def line_qml(color: str, width: float) -> str:
    """A style of lines; `width` in millimetres on paper."""
    symbol = _layer(
        "SimpleLine", {"line_color": _rgba(color), "line_width": f"{width:g}", "joinstyle": "round"}
    )
    return _vector_qml("line", symbol)


def point_qml(
    color: str, size: float, border: str = "#ffffff", *, angle: str = "", shape: str = "circle"
) -> str:
    """A style of points; `size` in millimetres, `angle` the column that turns each, clockwise from north."""
    options = marker(color, size, border, shape=shape)
    return _vector_qml("marker", _layer("SimpleMarker", options, {"angle": angle} if angle else {}))


def sized_point_qml(color: str, column: str, what: str, border: str = "#ffffff") -> str:
    """A style of round points: to scale where a size was measured, else small hollow dots.

    Args:
        color: Of the points.
        column: Their diameter in metres, NULL where none was measured.
        what: One of them is called in the legend.
        border: Colour around those to scale.
    """
    scaled = {
        "name": "circle",
        "color": _rgba(color, 200),
        "outline_color": _rgba(border),
        "outline_width": "0.1",
        "size": "0.25",
        "size_unit": "RenderMetersInMapUnits",
    }
    # In millimetres: a dot that grew with the map would be read as a size.
    dot = marker("#ffffff", 0.7, color, width=0.12)
    return _categorised(
        "marker",
        f"CASE WHEN \"{column}\" IS NULL THEN 'none' ELSE 'size' END",
        (
            ("size", f"{what}, to scale", _layer("SimpleMarker", scaled, {"size": column})),
            ("none", f"{what}, size not measured", _layer("SimpleMarker", dot)),
        ),
    )


def polygon_qml(color: str, border: str, width: float, opacity: int) -> str:
    """A style of polygons; `opacity` of the fill from 0 to 255."""
    return _vector_qml("fill", _layer("SimpleFill", fill(color, border, width, opacity)))


def categories_qml(
    kind: Literal["fill", "marker"], column: str, looks: Sequence[tuple[str, str, Mapping[str, str]]]
) -> str:
    """A style that tells the rows of a layer apart by the words in a column, each a line of the legend.

    Args:
        kind: `fill` for polygons, `marker` for points.
        column: That holds the words.
        looks: The words, what the legend calls them, and their look, as `fill` or `marker` gives it.
    """
    simple = {"fill": "SimpleFill", "marker": "SimpleMarker"}[kind]
    return _categorised(kind, column, [(words, label, _layer(simple, look)) for words, label, look in looks])


def fill(color: str, border: str, width: float, opacity: int, *, hatched: bool = False) -> dict[str, str]:
    """The look of polygons: `width` of the border in millimetres, `opacity` of the fill from 0 to 255."""
    return {
        "color": _rgba(color, opacity),
        "outline_color": _rgba(border),
        "outline_width": f"{width:g}",
        "style": "no" if not opacity else "b_diagonal" if hatched else "solid",
        "joinstyle": "round",
    }


def marker(
    color: str, size: float, border: str, *, shape: str = "circle", width: float = 0.15
) -> dict[str, str]:
    """The look of points: `size`, and `width` of the border, in millimetres."""
    return {
        "name": shape,
        "color": _rgba(color),
        "outline_color": _rgba(border),
        "outline_width": f"{width:g}",
        "size": f"{size:g}",
        "size_unit": "MM",
    }


def _layer(kind: str, options: Mapping[str, str], driven: Mapping[str, str] | None = None) -> str:
    """One layer of a symbol; `driven` are its properties that a column of the table sets."""
    settings = "".join(
        f'<Option type="QString" name="{name}" value={quoteattr(value)}/>' for name, value in options.items()
    )
    properties = "".join(
        f'<Option type="Map" name="{name}"><Option type="bool" name="active" value="true"/>'
        f'<Option type="QString" name="field" value={quoteattr(column)}/>'
        '<Option type="int" name="type" value="2"/></Option>'
        for name, column in (driven or {}).items()
    )
    data_defined = (
        '<data_defined_properties><Option type="Map"><Option type="QString" name="name" value=""/>'
        f'<Option type="Map" name="properties">{properties}</Option>'
        '<Option type="QString" name="type" value="collection"/></Option></data_defined_properties>'
        if properties
        else ""
    )
    return (
        f'<layer class="{kind}" enabled="1" locked="0" pass="0"><Option type="Map">{settings}</Option>'
        f"{data_defined}</layer>"
    )


def _vector_qml(kind: str, layer: str) -> str:
    return _renderer_qml('type="singleSymbol"', kind, [layer])


def _categorised(kind: str, attribute: str, looks: Sequence[tuple[str, str, str]]) -> str:
    """Of rows that a column or an expression tells apart: its words, what the legend calls them, their
    layer."""
    categories = "".join(
        f'<category symbol="{number}" value={quoteattr(words)} label={quoteattr(label)} type="string" '
        'render="true"/>'
        for number, (words, label, _) in enumerate(looks)
    )
    return _renderer_qml(
        f'type="categorizedSymbol" attr={quoteattr(attribute)}',
        kind,
        [layer for *_, layer in looks],
        f"<categories>{categories}</categories>",
    )


def _renderer_qml(attributes: str, kind: str, layers: Sequence[str], more: str = "") -> str:
    """Of symbols of one layer each, which are named by their numbers."""
    symbols = "".join(
        f'<symbol type="{kind}" name="{number}" alpha="1" clip_to_extent="1" force_rhr="0">{layer}</symbol>'
        for number, layer in enumerate(layers)
    )
    return (
        "<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
        '<qgis version="3.22.0" styleCategories="Symbology">'
        f'<renderer-v2 {attributes} forceraster="0" enableorderby="0" symbollevels="0">{more}<symbols>'
        f"{symbols}</symbols></renderer-v2><blendMode>0</blendMode></qgis>\n"
    )


def rgb(color: str) -> tuple[int, int, int]:
    """Of "#rrggbb"."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def _rgba(color: str, opacity: int = 255) -> str:
    return ",".join(map(str, (*rgb(color), opacity)))


def colormap(colors: Mapping[int, str], of: Sequence[int]) -> dict[int, tuple[int, int, int, int]]:
    """A GeoTIFF's colours of the values `of`."""
    return {value: (*rgb(colors[value]), 255) for value in of}
