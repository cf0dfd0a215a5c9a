"""How colcon and pip install valve_sim. Name, version, people and addresses are package.xml's."""

from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

HERE = Path(__file__).parent
MANIFEST = ElementTree.parse(HERE / "package.xml").getroot()
NAME = MANIFEST.findtext("name", "")
SHARE = Path("share") / NAME

RUNS_WITHOUT_ROS = [
    "click>=8.1",
    "jinja2>=3.0",
    "llvmlite>=0.41",
    "lz4>=4.0",
    "matplotlib>=3.6",
    "mcap>=1.2",
    "numpy>=1.24",
    "pyyaml>=6.0",
    "rich>=13.0",
    "rosbags>=0.11",
    "scipy>=1.11",
    "threadpoolctl>=3.0",
    "zstandard>=0.20",
]
URLS = {url.attrib["type"]: url.text or "" for url in MANIFEST.findall("url")}
CLASSIFIERS = [
    "Development Status :: 4 - Beta",
    "Environment :: Console",
    "Intended Audience :: Manufacturing",
    "Intended Audience :: Science/Research",
    "Operating System :: POSIX :: Linux",
    "Programming Language :: Python :: 3",
    *(f"Programming Language :: Python :: 3.{minor}" for minor in range(10, 15)),
    "Topic :: Scientific/Engineering :: Physics",
    "Typing :: Typed",
]
# The two cannot share an environment: they pin different versions of the same messages.
ROS_JAZZY = [
    "ros-jazzy-rclpy==7.1.6",
    "ros-jazzy-rmw-fastrtps-cpp",
    "ros-jazzy-std-msgs",
    "ros-jazzy-sensor-msgs",
    "ros-jazzy-diagnostic-msgs",
    "ros-jazzy-std-srvs",
]
ROS_KILTED = [
    "ros-kilted-rclpy==9.1.2",
    "ros-kilted-rmw-fastrtps-cpp",
    "ros-std-msgs==5.5.1",
    "ros-sensor-msgs==5.5.1",
    "ros-diagnostic-msgs==5.5.1",
    "ros-std-srvs==5.5.1",
]
PARQUET = ["pyarrow>=14.0"]
TABLES = ["nptdms>=1.7", "openpyxl>=3.1"]
FLEET = ["dask>=2024.1", "distributed>=2024.1", "fsspec>=2024.2", "s3fs>=2024.2", *PARQUET]
OPCUA = ["asyncua>=2.1,<3"]
MODBUS = ["pymodbus>=3.16,<4"]
FMI = ["pythonfmu>=0.7", "fmpy>=0.3.20"]
S3_SERVER = ["flask", "flask-cors", "moto"]
CHECKS = [
    "codespell>=2.2",
    "coverage>=7.2",  # of benchmarks.mutation
    "hypothesis",
    "import-linter",
    "mypy",
    "numba>=0.58",  # of the independent plants of the tests
    "pytest",
    "pytest-timeout",
    "pytest-xdist",
    "ruff",
    "scipy-stubs",
    "types-PyYAML",
]
DOCUMENTATION = ["furo", "ipykernel", "latex2mathml", "myst-nb", "proselint>=0.16", "sphinx>=7.3", "sphinx-click"]


def shared_files(*folders: str) -> list[tuple[str, list[str]]]:
    """Every file under the folders, for the same place below share/valve_sim (a recorded bag is a folder of files)."""
    files = [path for folder in folders for path in sorted((HERE / folder).rglob("*")) if path.is_file()]
    kept = [path.relative_to(HERE) for path in files if "__pycache__" not in path.parts]
    return [(str(SHARE / path.parent), [str(path)]) for path in kept]


setup(
    name=NAME,
    version=MANIFEST.findtext("version"),
    description=MANIFEST.findtext("description"),
    maintainer=MANIFEST.findtext("maintainer"),
    maintainer_email=MANIFEST.find("maintainer").attrib["email"],
    license=MANIFEST.findtext("license"),
    license_files=["LICENSE"],
    long_description=(HERE / "README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    author=MANIFEST.findtext("author"),
    author_email=MANIFEST.find("author").attrib["email"],
    url=URLS["repository"],
    project_urls={"Bug tracker": URLS["bugtracker"], "Paper of the model": URLS["website"]},
    classifiers=CLASSIFIERS,
    keywords=["ROS", "fault diagnosis", "hybrid systems", "solenoid valve", "system identification"],
    python_requires=">=3.10,<3.15",
    packages=find_packages(include=["valve_sim", "valve_sim.*"]),
    package_data={
        NAME: ["py.typed"],
        f"{NAME}.files": ["plant_templates/*.yaml"],
        f"{NAME}.identification.reporting": ["templates/*.j2"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (str(SHARE), ["package.xml"]),
        ("share/bash-completion/completions", ["completions/valve-sim"]),
        ("share/zsh/site-functions", ["completions/_valve-sim"]),
        ("share/fish/vendor_completions.d", ["completions/valve-sim.fish"]),
        *shared_files("config", "launch", "bags"),
    ],
    zip_safe=False,
    install_requires=RUNS_WITHOUT_ROS,
    extras_require={
        "ros": ROS_JAZZY,
        "ros-kilted": ROS_KILTED,
        "parquet": PARQUET,
        "tables": TABLES,
        "fleet": FLEET,
        "fmi": FMI,
        "opcua": OPCUA,
        "modbus": MODBUS,
        "checks": CHECKS,
        "test": [*CHECKS, *FLEET, *FMI, *OPCUA, *MODBUS, *S3_SERVER, *TABLES],
        "docs": DOCUMENTATION,
    },
    entry_points={
        "console_scripts": [
            "archive_node = valve_sim.station.__main__:archive_node",
            "command_profile = valve_sim.nodes.__main__:command_profile",
            "identification_node = valve_sim.nodes.__main__:identification_node",
            "monitor_node = valve_sim.nodes.__main__:monitor_node",
            "opcua_node = valve_sim.station.__main__:opcua_node",
            "plc_node = valve_sim.station.__main__:plc_node",
            "valve_node = valve_sim.nodes.__main__:valve_node",
            "valve-sim = valve_sim.__main__:main",
        ],
    },
)
