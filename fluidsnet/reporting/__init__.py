"""Tables, charts and figures of a run, and the folders they lie in."""
