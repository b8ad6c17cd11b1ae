"""Where a result comes from, the same for every kind of calibration."""

from ..calibration import Provenance
from .page import Section, Table


def provenance_section(provenance: Provenance) -> Section:
    """Return the section with version, method, options, seed and the hashes of the inputs."""
    rows = [("gnomon", provenance.gnomon_version), ("method", provenance.method)]
    options = ", ".join(f"{name} = {value}" for name, value in provenance.options.items())
    rows.append(("options", options or "all at their defaults"))
    if provenance.seed is not None:
        rows.append(("seed", str(provenance.seed)))
    blocks = [Table("How it was made", ("", ""), rows, prose=True)]
    if provenance.inputs:
        blocks.append(
            Table(
                "Inputs",
                ("file", "SHA-256"),
                tuple((source.name, source.sha256) for source in provenance.inputs),
                "The same inputs, options and version give the same calibration and report, byte for byte.",
                prose=True,
            )
        )
    return Section("provenance", "Provenance", blocks=blocks)
