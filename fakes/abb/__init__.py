"""A controller of ABB: web services of both generations, and its position stream."""
