"""The house in numbers: modules, lines, importers, documented parameters and words of documents, by revision.

No figure is a target by itself; each shows where the package still creaks.
"""
