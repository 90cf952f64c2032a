"""A survey in the formats that its readers already open: maps, a GeoPackage, netCDF, Darwin Core, a mosaic,
reports."""

from dream.survey.products.darwin_core import Author, Species
from dream.survey.products.export import OVER_TIME, PRODUCTS, Exported, export

__all__ = ["OVER_TIME", "PRODUCTS", "Author", "Exported", "Species", "export"]
