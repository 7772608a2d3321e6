"""Whether every import package of ours is really ours.

PyPI has an unrelated ``qpmpc`` (by S. Caron) with the same import name, and pip installs one over
the other without a word. The packages' metadata tell.
"""

from importlib.metadata import packages_distributions

ROOTS = ("qpmpc", "plant", "scenarios", "bench")
DISTRIBUTION = "pulsempc"


def foreign_owners() -> dict[str, list[str]]:
    """Return, for each import package that another distribution claims, who claims it.

    An editable installation claims no names itself, so the absence of an owner is fine.
    """
    owners = packages_distributions()
    foreign = {root: sorted(set(owners.get(root, ())) - {DISTRIBUTION}) for root in ROOTS}
    return {root: names for root, names in foreign.items() if names}


def complaint() -> str | None:
    """Return one line that says who else owns our import packages and what to do, or None."""
    foreign = foreign_owners()
    if not foreign:
        return None
    claims = "; ".join(f"'{root}' by {', '.join(names)}" for root, names in foreign.items())
    others = " ".join(sorted({name for names in foreign.values() for name in names}))
    return (
        f"import packages of pulsempc are claimed by other distributions: {claims}. "
        f"pip uninstall {others} and reinstall pulsempc, or give it an environment of its own"
    )
