"""SpatialAnalyzer's bridge T2SA, and the instrument behind it."""
