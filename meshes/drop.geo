// A ball of 6 cm that touches z = 0, finer around the lowest point.
// drop.msh is made by:  gmsh -3 -format msh41 drop.geo
// The demo rests on the .msh file that is kept here; Gmsh releases number nodes differently.
SetFactory("OpenCASCADE");
radius = 0.03;
fine = 0.0025;
coarse = 0.011;
Sphere(1) = {0, 0, radius, radius};
Field[1] = MathEval;
Field[1].F = Sprintf("%g + %g * Max(0, Sqrt(x^2 + y^2 + z^2) - 0.011) / 0.030", fine, coarse - fine);
Background Field = 1;
Mesh.MeshSizeExtendFromBoundary = 0;
Mesh.MeshSizeFromPoints = 0;
Mesh.MeshSizeMax = coarse;
Physical Volume("body") = {1};
Physical Surface("skin") = {1};
