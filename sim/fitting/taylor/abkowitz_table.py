"""Table 2 of the paper: identified coefficients of the 23-term Taylor model, copied number by number.

Source: "Data driven identification and model predictive control for a catamaran surface vessel", Table 2
("Identified Hydrodynamic coefficients"). Order of the terms: equation (4); the regressor printed as (6a)
repeats v^2 r where (4) has v^2 Delta u, and Table 2 lists C_vvu, so (4) is right and (6a) a misprint.
"""

NOMINAL_U_M_S = 0.5
"""Speed around which the series is taken (section 3.2): Delta u = u - 0.5."""

TERMS = (
    "0", "u", "v", "r", "uu", "vv", "rr", "uv", "ur", "vr", "uuu", "vvv", "rrr", "uuv", "uur", "vvu", "vvr",
    "rru", "rrv", "uvr", "x", "y", "n",
)  # fmt: skip
"""Subscript of each term; u stands for Delta u, x y n for t_x t_y t_n."""

SURGE = (
    0.0, -0.0472, -0.0022, -0.0693, 0.1222, 0.1493, -0.1172, -0.3011, -0.0867, 0.5930, -0.1993, 0.0745, 0.1971,
    0.3562, -0.2348, 0.5726, -0.1181, 0.4229, -0.2630, 1.8988, 0.0089, 0.0, 0.0279,
)  # fmt: skip
SWAY = (
    0.0, 0.0016, -0.0542, 0.0312, 0.1106, -0.0198, -0.0639, -0.5449, -0.7225, -0.1211, -0.4348, 0.2863, 0.0361,
    0.4971, -0.6637, -0.0834, 0.5999, 0.1556, 0.0864, -0.1744, -0.0011, 0.0, -0.1132,
)  # fmt: skip
YAW = (
    0.0, 0.0179, 0.0174, -0.2562, 0.0426, 0.0310, -0.0251, -0.0913, 0.0263, 0.0644, -0.0256, -0.0777, -0.7737,
    0.0576, 0.0292, -0.0184, -0.5678, 0.0404, 0.1086, 0.3863, -0.00064, 0.0, 0.3873,
)  # fmt: skip
