"""What every stage works on: arrays, polylines, views and 3D edges."""
