"""Colors of pictures and movies, other than those of speed."""

BACKGROUND, FLOOR, LINES, TEXT = "#0c1016", "#171d27", "#6d7a8c", "#e4e9f0"

#: Gray of solid particles.
SOLID = 0.5
