// A fishtail: a silicone body that tapers, with an air chamber in each flank, cast around a carbon sheet of 0.5 mm, which
// goes on as the fin. x to the tail, y up, z to the left flank; m.
// fishtail.msh is made by:  gmsh -3 -format msh41 -bin fishtail.geo
SetFactory("OpenCASCADE");
body = 0.16; fin = 0.24; core = 0.00025;

Point(1) = {0, -0.030, 0}; Point(2) = {body, -0.015, 0}; Point(3) = {body, 0.015, 0}; Point(4) = {0, 0.030, 0};
Line(1) = {1, 2}; Line(2) = {2, 3}; Line(3) = {3, 4}; Line(4) = {4, 1};
Curve Loop(1) = {1, 2, 3, 4}; Plane Surface(1) = {1};
side[] = Extrude {0, 0, 0.04} { Surface{1}; };
Translate {0, 0, -0.02} { Volume{side[1]}; }

Point(21) = {0, -0.1, -0.018}; Point(22) = {body, -0.1, -0.012}; Point(23) = {body, -0.1, 0.012};
Point(24) = {0, -0.1, 0.018};
Line(21) = {21, 22}; Line(22) = {22, 23}; Line(23) = {23, 24}; Line(24) = {24, 21};
Curve Loop(21) = {21, 22, 23, 24}; Plane Surface(21) = {21};
top[] = Extrude {0, 0.2, 0} { Surface{21}; };
silicone() = BooleanIntersection{ Volume{side[1]}; Delete; }{ Volume{top[1]}; Delete; };

Box(101) = {0.015, -0.012, 0.0020, 0.110, 0.024, 0.0030};
Box(102) = {0.015, -0.012, -0.0050, 0.110, 0.024, 0.0030};
hollow() = BooleanDifference{ Volume{silicone()}; Delete; }{ Volume{101, 102}; Delete; };

Point(201) = {0, -0.026, -core}; Point(202) = {body, -0.012, -core}; Point(203) = {fin, -0.055, -core};
Point(204) = {fin - 0.02, 0, -core}; Point(205) = {fin, 0.055, -core}; Point(206) = {body, 0.012, -core};
Point(207) = {0, 0.026, -core};
Line(201) = {201, 202}; Line(202) = {202, 203}; Line(203) = {203, 204}; Line(204) = {204, 205};
Line(205) = {205, 206}; Line(206) = {206, 207}; Line(207) = {207, 201};
Curve Loop(201) = {201, 202, 203, 204, 205, 206, 207}; Plane Surface(201) = {201};
sheet[] = Extrude {0, 0, 2 * core} { Surface{201}; };
BooleanFragments{ Volume{hollow()}; Delete; }{ Volume{sheet[1]}; Delete; }
Coherence;

e = 1e-5;
carbon() = Volume In BoundingBox{-e, -0.056, -core - e, fin + e, 0.056, core + e};
all() = Volume{:};
rest() = all();
rest() -= carbon();
Physical Volume("carbon") = {carbon()};
Physical Volume("silicone") = {rest()};
Physical Surface("root") = {Surface In BoundingBox{-e, -1, -1, e, 1, 1}};
Physical Surface("left") = {Surface In BoundingBox{0.015 - e, -0.012 - e, 0.002 - e, 0.125 + e, 0.012 + e, 0.005 + e}};
Physical Surface("right") = {Surface In BoundingBox{0.015 - e, -0.012 - e, -0.005 - e, 0.125 + e, 0.012 + e, -0.002 + e}};
Mesh.MeshSizeMin = 0.013; Mesh.MeshSizeMax = 0.013;
