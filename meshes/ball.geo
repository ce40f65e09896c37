// A ball of 30 mm about the origin. gmsh -3 -format msh41 ball.geo -o ball.msh
SetFactory("OpenCASCADE");
Mesh.MeshSizeMin = 5.5e-3;
Mesh.MeshSizeMax = 5.5e-3;
Sphere(1) = {0, 0, 0, 0.015};
Physical Volume("body") = {1};
Physical Surface("skin") = {1};
