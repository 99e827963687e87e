"""The apartment: a day with people and objects, cameras and a robot that lives in it."""
