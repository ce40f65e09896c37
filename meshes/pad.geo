// A pad of 20 x 20 x 10 mm on the plane z = 0: 2 x 2 x 1 bricks of six tetrahedra.
// pad.msh is made by:  gmsh -3 -format msh41 pad.geo
Point(1) = {-0.01, -0.01, 0};
Extrude {0.02, 0, 0} { Point{1}; Layers{2}; }
out[] = Extrude {0, 0.02, 0} { Curve{1}; Layers{2}; };
body[] = Extrude {0, 0, 0.01} { Surface{out[1]}; Layers{1}; };
Physical Volume("body") = {body[1]};
Physical Surface("back") = {out[1]};
Physical Surface("face") = {body[0]};
