"""Instruments that SpatialAnalyzer drives, through its bridge T2SA."""
