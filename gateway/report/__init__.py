"""Pages from results: numbers and sentences (view), pictures (svg, figures, space), one shell (page).

`render` is the page on a result. Each page is drawn from the typed result alone: what that does not hold is left out.
"""
