"""Boats drawn at random: the structured fit judged by errors, coverage and open loops."""
