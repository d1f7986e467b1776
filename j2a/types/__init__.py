"""The types of J2A: what the payloads of functions and SIFs mean (SPEC.md, sections 19 and 20).

`model` holds what a signature or an interface says, `parser` reads its text, `annotations` those of
Python functions, `coding` packs values into payloads and back. Nothing here does input or output.
"""
