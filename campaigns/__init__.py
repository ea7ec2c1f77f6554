"""Long tests of the whole program, beside `make test`: README.md says what each proves."""
