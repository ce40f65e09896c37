// The paper's cylinder, 0.6 m long and 1.5 cm thick, as an octagon in 24 layers: few unknowns for degree 2.
// cylinder.msh is made by:  gmsh -3 -format msh41 -bin cylinder.geo
r = 0.0075;
Point(9) = {0, 0, 0};
For k In {0:7}
  Point(1 + k) = {0, r * Cos(k * Pi / 4), r * Sin(k * Pi / 4)};
EndFor
For k In {0:7}
  Line(1 + k) = {1 + k, 1 + (k + 1) % 8};
  Line(11 + k) = {9, 1 + k};
EndFor
For k In {0:7}
  Curve Loop(1 + k) = {11 + k, 1 + k, -(11 + (k + 1) % 8)};
  Plane Surface(1 + k) = {1 + k};
  out[] = Extrude {0.6, 0, 0} { Surface{1 + k}; Layers{24}; };
  end(k) = out[0];
  body(k) = out[1];
EndFor
Physical Volume("body") = {body[]};
Physical Surface("ends") = {1:8, end[]};
MeshSize{:} = 1;
