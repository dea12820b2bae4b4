"""The origin of results: keys of code, configuration and inputs; which results are kept, which are made again, and
why.
"""
