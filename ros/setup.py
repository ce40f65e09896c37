"""As colcon builds packages of the kind ament_python; the release's number stands in package.xml."""

from xml.etree import ElementTree

from setuptools import setup

NAME = "fenics_rom_ros"
PACKAGE = ElementTree.parse("package.xml")

setup(
    name=NAME,
    version=PACKAGE.findtext("version"),
    description=PACKAGE.findtext("description"),
    license=PACKAGE.findtext("license"),
    maintainer=PACKAGE.findtext("maintainer"),
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/body.launch.py"]),
    ],
    install_requires=["setuptools", "fenics-rom"],
    zip_safe=True,
    entry_points={"console_scripts": [f"body = {NAME}.node:main"]},
)
