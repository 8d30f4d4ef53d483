"""HTML pages from results: numbers and text (`view`), figures (`svg`, `figures`, `space`), page frame (`page`).

`render` writes the page of a result. Pages use only the typed result; missing parts are omitted.
"""
