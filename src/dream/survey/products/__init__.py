"""A survey in the formats that its readers already open: maps, a GeoPackage, netCDF, Darwin Core, a mosaic,
reports."""

from dream.survey.products.darwin_core import Author, Species
from dream.survey.products.export import PRODUCTS, Exported, export

__all__ = ["PRODUCTS", "Author", "Exported", "Species", "export"]
