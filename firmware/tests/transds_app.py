"""The task of an application whose functions.def is empty and that has a transds.def."""


def app_task(first: str = "") -> str:
    """Return it in C: it begins with the transducers once, then serves them.

    Args:
        first: statements before they are served, in each turn.
    """
    return f"""\
void j2a_app_task(void) {{
    static bool begun;
    if (!begun)
        transds_init();
    begun = true;
    {first}
    transds_process();
}}
"""
