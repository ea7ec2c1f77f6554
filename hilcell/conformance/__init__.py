"""The conformance kit: tests whether a driver keeps the promises of its port."""
