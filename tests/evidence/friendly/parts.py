"""Evidence for the first hour: installation, the page on the bank, logs that open
where people look at them, the command line, and another kind of processor."""

from tests.evidence.friendly import arm64, commands, console, documents, driving, install, logs_out

PARTS = (
    *install.PARTS,
    *console.PARTS,
    *driving.PARTS,
    *logs_out.PARTS,
    *documents.PARTS,
    *commands.PARTS,
    *arm64.PARTS,
)
