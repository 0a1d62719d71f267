"""A text model of three images and one point, written line by line."""

CAMERA = "1 PINHOLE 640 480 500 500 320 240"
POSES = ["1 1 0 0 0 0 0 0 1 a.png", "2 1 0 0 0 -1 0 0 1 b.png", "3 1 0 0 0 -2 0 0 1 c.png"]
PIXELS = ["320 240 7 10 20 -1", "220 240 7", "120 240 7"]
POINT = "7 0 0 5 1 2 3 0.1 1 0 2 0 3 0"


def write(folder, images, points=(), cameras=(CAMERA,), end="\n", mark=b""):
    for name, lines in (("cameras", cameras), ("images", images), ("points3D", points)):
        (folder / f"{name}.txt").write_bytes(mark + (end.join(lines) + end).encode())
