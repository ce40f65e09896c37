"""Where two bodies touch, or are about to: pairs of points with gaps and normals."""
