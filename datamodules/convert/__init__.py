"""Converters of particle data in other formats, one format a file."""
