"""Evidence for the first hour: installation, the page on the bank, logs that open where people look at them."""

from tests.evidence.friendly import commands, console, driving, install, logs_out

PARTS = (*install.PARTS, *console.PARTS, *driving.PARTS, *logs_out.PARTS, *commands.PARTS)
