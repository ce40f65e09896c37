// A bar of 0.2 x 0.06 x 0.02 m about the origin: 8 x 3 x 1 bricks of six tetrahedra.
// bar.msh is made by:  gmsh -3 -format msh41 bar.geo
Point(1) = {-0.1, -0.03, -0.01};
Extrude {0.2, 0, 0} { Point{1}; Layers{8}; }
out[] = Extrude {0, 0.06, 0} { Curve{1}; Layers{3}; };
body[] = Extrude {0, 0, 0.02} { Surface{out[1]}; Layers{1}; };
Physical Volume("body") = {body[1]};
Physical Surface("skin") = {out[1], body[0], body[2], body[3], body[4], body[5]};
Physical Surface("end") = {body[3]};
