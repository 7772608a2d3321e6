"""What a cycle costs under each backend: recorded cycles, solved by all of them, timed apart."""
