"""The version of Sightline: this line is where the package, its results and its metadata have it from."""

VERSION = "0.1.0"
