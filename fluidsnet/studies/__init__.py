"""Studies: they run models and write tables and figures."""
