// The paper's silicone cylinder, 0.6 m long and 1.5 cm thick; at mesh size factor 0.8 about its 3,842 nodes.
// gmsh -3 -clscale 0.8 cylinder.geo
SetFactory("OpenCASCADE");
Cylinder(1) = {0, 0, 0, 0.6, 0, 0, 0.0075};
MeshSize{:} = 0.0042;
Physical Volume("body") = {1};
Physical Surface("side") = {1};
Physical Surface("ends") = {2, 3};
