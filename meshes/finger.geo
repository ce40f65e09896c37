// A soft finger, 0.1 x 0.02 x 0.02 m, fixed at x = 0, with a closed chamber in its upper half.
// finger.msh is made by:  gmsh -3 -format msh41 -bin finger.geo
SetFactory("OpenCASCADE");
Box(1) = {0, -0.01, -0.01, 0.1, 0.02, 0.02};
Box(2) = {0.01, -0.006, -0.001, 0.08, 0.012, 0.007};
BooleanDifference(3) = { Volume{1}; Delete; }{ Volume{2}; Delete; };
e = 1e-4;
Physical Volume("body") = {3};
Physical Surface("root") = Surface In BoundingBox{-e, -0.01 - e, -0.01 - e, e, 0.01 + e, 0.01 + e};
Physical Surface("chamber") = Surface In BoundingBox{0.01 - e, -0.006 - e, -0.001 - e, 0.09 + e, 0.006 + e, 0.006 + e};
MeshSize{:} = 0.0117;
