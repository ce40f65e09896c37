// A soft tongue, 0.1 x 0.1 x 0.02 m, in layers that are thinner towards its root, where it is held.
// tongue.msh is made by:  gmsh -3 -format msh41 -bin tongue.geo
DefineConstant[ across = 2 ];   // cells through the thickness
layers = 8 * across;
For k In {1:layers}
  one[k-1] = 1;
  place[k-1] = (k / layers)^1.5;
EndFor
For j In {0:3}
  Point(1 + j) = {0, j * 0.1 / 3, 0};
  Point(5 + j) = {0, j * 0.1 / 3, 0.02};
  Line(20 + j) = {1 + j, 5 + j};
EndFor
For j In {0:2}
  Line(10 + j) = {1 + j, 2 + j};
  Line(15 + j) = {5 + j, 6 + j};
EndFor
Transfinite Curve{10:12, 15:17} = across + 2;
Transfinite Curve{20:23} = across + 1;
For j In {0:2}
  Curve Loop(1 + j) = {10 + j, 21 + j, -(15 + j), -(20 + j)};
  Plane Surface(1 + j) = {1 + j};
  Transfinite Surface{1 + j};
  out[] = Extrude {0.1, 0, 0} { Surface{1 + j}; Layers{ one[], place[] }; };
  tip(j) = out[0];
  body(j) = out[1];
EndFor
Physical Volume("body") = {body[]};
Physical Surface("root") = {1:3};
Physical Surface("right") = {tip(0)};
Physical Surface("left") = {tip(2)};
