"""Evidence for the first hour: the page on the bank, and logs that open where people look at them."""

from tests.evidence.friendly import commands, console, logs_out

PARTS = (*console.PARTS, *logs_out.PARTS, *commands.PARTS)
