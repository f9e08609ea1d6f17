"""Statistical tests for scenes and samplers: chi-square, z-tests of images, finite differences, dot products.

Every test returns a result whose truth value says whether it passed, with a message that says by how much.
"""

from .chi_square import ChiSquareResult, chi2_test
from .gradients import (
    DotProductResult,
    FiniteDifferences,
    GradientResult,
    check_gradients,
    dot_product_test,
    finite_differences,
)
from .images import ZTestResult, mean_and_variance, z_test
from .probes import BsdfProbe, PhaseProbe, emitter_density, sample_emitters
from .statistics import chi2_p_value, normal_p_value, sidak, student_p_value

__all__ = [
    "BsdfProbe",
    "ChiSquareResult",
    "DotProductResult",
    "FiniteDifferences",
    "GradientResult",
    "PhaseProbe",
    "ZTestResult",
    "check_gradients",
    "chi2_p_value",
    "chi2_test",
    "dot_product_test",
    "emitter_density",
    "finite_differences",
    "mean_and_variance",
    "normal_p_value",
    "sample_emitters",
    "sidak",
    "student_p_value",
    "z_test",
]
