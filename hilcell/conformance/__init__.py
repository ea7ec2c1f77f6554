"""The conformance kit: does a driver keep the promises of its port?"""
