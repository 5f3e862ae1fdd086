"""The judge: a trial of one retraction on the finite elements, and the certificate that it ends in."""

from planners.certify.certificate import FAILURES, REASONS, Certificate
from planners.certify.retraction import Closed, Retraction
from planners.certify.robust import Robust
from planners.certify.trial import Trial, certify, differences, stated, timed, verified

__all__ = [
    "FAILURES",
    "REASONS",
    "Certificate",
    "Closed",
    "Retraction",
    "Robust",
    "Trial",
    "certify",
    "differences",
    "stated",
    "timed",
    "verified",
]
