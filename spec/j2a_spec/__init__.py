"""The specification of J2A as code: constants, grammars, oracle, requirements and vectors.

Nothing here runs a link. `j2a` implements the protocol, `j2a_conformance` judges implementations;
both take their facts from this package. The text of the specification is in `spec/SPEC.md`.
"""

from j2a_spec.constants import SPEC_VERSION

__all__ = ["SPEC_VERSION"]
