def convert_model():
    pass
