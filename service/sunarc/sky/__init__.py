"""Position of the sun, the moon, planets and bright stars, refraction, directions and local mean solar days."""
