// The silicone beam, 100 x 30 x 30 mm, m: x from the middle of the clamped face to the tip, z up; layers that are thinner
// towards the clamp. beam.msh is made by:  gmsh -3 -format msh41 -bin beam.geo
DefineConstant[ across = 3 ];   // cells through the thickness
layers = 7;
For k In {1:layers}
  one[k-1] = 1;
  place[k-1] = (k / layers)^1.3;
EndFor
h = 0.015;
Point(1) = {0, -h, -h}; Point(2) = {0, h, -h}; Point(3) = {0, h, h}; Point(4) = {0, -h, h};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Transfinite Curve{1:4} = across + 1;
Curve Loop(1) = {1:4}; Plane Surface(1) = {1};
Transfinite Surface{1} Alternate;
body[] = Extrude {0.1, 0, 0} { Surface{1}; Layers{ one[], place[] }; };
Physical Volume("body") = {body[1]};
Physical Surface("root") = {1};
Physical Surface("tip") = {body[0]};
