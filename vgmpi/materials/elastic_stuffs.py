"""Presets of elastic solids, whatever their law."""

# rubber (natural, unfilled), silicone, cork, wood (balsa, mean of its directions): Gibson and
# Ashby, Cellular Solids, 2nd ed. 1997, and Ashby, Materials Selection in Mechanical Design,
# 4th ed. 2011, appendix A; jelly, gelatine of some percent: Markidou et al., J. Food Eng. 68
# (2005) 295. Rubber, silicone and jelly have a Poisson ratio near 0.5, which locks: 0.45
STUFFS: dict[str, dict] = {
    "rubber": {"density": 930.0, "youngs_modulus": 2e6, "poisson_ratio": 0.45},
    "silicone": {"density": 1150.0, "youngs_modulus": 5e5, "poisson_ratio": 0.45},
    "jelly": {"density": 1020.0, "youngs_modulus": 1e4, "poisson_ratio": 0.45},
    "cork": {"density": 170.0, "youngs_modulus": 2e7, "poisson_ratio": 0.05},
    "wood": {"density": 160.0, "youngs_modulus": 1e9, "poisson_ratio": 0.3},
}
