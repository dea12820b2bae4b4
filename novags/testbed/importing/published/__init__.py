"""Published low-light data sets: where their dark pictures, lit twins, cameras and splits lie. `datasets.DATASETS`."""
