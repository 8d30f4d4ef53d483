"""One HTML page from one result: numbers and sentences (view), pictures (svg, figures, arm), template.

The page is drawn from the result JSON alone. Beside the keys of `gateway.result.result` it reads the object `data`
(each key optional; what is absent is left out of the page):

    created, software, cell, arm     str
    sources        [{"file", "kind", "visits", "exit_status"}]
    poses          [{"pose", "load", "q_rad": [N], "points_m": [[x, y, z], ...] base to flange, "com_m": [x, y, z]}]
    model_before_nm  rows x N, aligned with `rows`: what the model said before the effects were added
    band_model_nm, band_model_before_nm  rows x N: what the model says, and said before, of half the difference of the
                     two sides of a visit (`band_nm` of the rows is what was measured of it)
    role           one word per row of `rows`: "fit", "held out", "fresh"
    curves         [{"name", "joint", "x_label", "x_unit", "y_label", "x", "y", "low", "high", "points_x", "points_y"}]
    bus            [{"name", "cycles", "incomplete", "late", "planned_load_percent", "emcy", ...}]
    torque_limit_nm  [N]
    flange         {label: {"com_std_m": [3], "correlation": 4 x 4}}: uncertainty in the frame of the flange

`provenance` of the result holds {"J2": {"gear_ratio": {"value", "unit", "source"}, ...}, ...}.
"""
